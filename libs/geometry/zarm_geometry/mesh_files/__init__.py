"""Reads mesh files completely: what is not in the result is an error or in its notes.

Every reader counts what the text or the bytes hold, apart from the code that builds the triangles, and compares the two.
"""

from zarm_geometry.mesh_files.formats import FORMATS, Beside, read
from zarm_geometry.mesh_files.mesh_file import MeshFile, Unreadable

__all__ = ["FORMATS", "Beside", "MeshFile", "Unreadable", "read"]
