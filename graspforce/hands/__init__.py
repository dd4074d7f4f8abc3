"""The hands that ship, as data: a description (JSON) and, where we wrote it, a URDF each."""
