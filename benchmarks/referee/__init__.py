"""Contacts solved by CalculiX on solid meshes: a frozen referee of the project's own simulator.

What is solved
--------------
Dead patch loads (even pressure along the inward normal at rest, 1 N times the force along the
normal at the centre, as :func:`patch_loads`) on the shell as printed,
rims held; quadratic tetrahedra, large displacements (NLGEOM), the full load reached. Receptors
within 20 mm of a contact (15 mm where there are several), tubes and holes, are the CAD's; the wall
farther away is a smeared one (:mod:`verification.partial_solid`), and tips there stand
rigidly on it. Pressure acts on the wall's material:
holes carry none, while the twin's shell is pressed over them too, which moves the tip of a pressed
receptor by about half a percent of the peak.

Files
-----
``contacts.py``
    Draws the contacts; ``data/DESIGN.contacts.json`` holds them, written once.
``solve.py``
    ``python -m benchmarks.referee.solve --design cylinder60 [--limit N] [--processes K]`` solves
    what is not in ``data/DESIGN.npz`` yet; each contact is written when it is done, so it can be
    killed and started again. Two to ten minutes of one core and 1 to 4 GB for each contact; needs
    Gmsh and ``ccx``. One run for each design at a time: use ``--processes`` for more.
``read.py``
    Reads the data and rejects those of another sensor.

``python -m benchmarks.twin`` judges the twin's shell by them.
"""
