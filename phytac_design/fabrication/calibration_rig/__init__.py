"""Calibration kit: indenters, grippers, jigs that fit the shape, and the motion program."""
