"""Text of mesh files, in whichever encoding it was saved."""

from __future__ import annotations

import codecs

from zarm_geometry.mesh_files.mesh_file import Unreadable

# UTF-32 begins with the mark of UTF-16, so it comes first.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def plain(content: bytes) -> bytes:
    """Text whose keywords and numbers are ASCII; names may be in any encoding. Raises Unreadable."""
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            try:
                content = content.decode(encoding, "replace").encode()
            except UnicodeError as error:
                raise Unreadable(f"it is broken {encoding.upper()} text; save it as UTF-8") from error
            break
    if b"\0" in content:
        raise Unreadable("it is not text, or in an encoding that it does not state; save it as UTF-8")
    return content


def shown(word: bytes) -> str:
    """A word of a file, short enough for a message."""
    return repr(word[:40].decode("utf-8", "replace"))
