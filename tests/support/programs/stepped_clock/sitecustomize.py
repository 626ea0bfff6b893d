"""Steps CLOCK_REALTIME as this whole process sees it; Python imports this file first where its folder is on the path.

The first 28 bytes of the C library's `clock_gettime`, through which Python, Rust and C alike read the clock, are replaced by
the system call and an addition: of the seconds in the file `$ZARM_TEST_CLOCK` to the answer for CLOCK_REALTIME, which is
clock 0. No other clock is touched, and no compiler is needed.
"""

import ctypes
import mmap
import os
from pathlib import Path

PAGE = mmap.PAGESIZE
READ_EXECUTE, WRITE = 5, 2

with Path(os.environ["ZARM_TEST_CLOCK"]).open("r+b") as file:
    shared = mmap.mmap(file.fileno(), 8)
offset = ctypes.c_int64.from_buffer(shared)
code = (
    b"\xb8\xe4\x00\x00\x00"  # mov eax, 228  (clock_gettime)
    b"\x0f\x05"  # syscall
    b"\x85\xff"  # test edi, edi
    b"\x75\x10"  # jne to ret
    b"\x48\xb9"
    + ctypes.addressof(offset).to_bytes(8, "little")  # mov rcx, address of the offset
    + b"\x48\x8b\x09"  # mov rcx, [rcx]
    b"\x48\x01\x0e"  # add [rsi], rcx
    b"\xc3"  # ret
)
libc = ctypes.CDLL(None, use_errno=True)
target = ctypes.cast(libc.clock_gettime, ctypes.c_void_p).value or 0
pages = ctypes.c_void_p(target & -PAGE), ctypes.c_size_t(2 * PAGE)
if libc.mprotect(*pages, READ_EXECUTE | WRITE) != 0:
    raise OSError(ctypes.get_errno(), "the C library cannot be made writable")
ctypes.memmove(target, code, len(code))
libc.mprotect(*pages, READ_EXECUTE)
