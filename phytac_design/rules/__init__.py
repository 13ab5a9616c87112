"""Whether a design can be built at all: cheap checks made before any solid, mesh or picture.

Every check is a function that returns nothing or raises one :class:`DesignError` with what fails,
by how much, and the fix. Rows and columns are counted from 0, row 0 nearest the camera.
"""
