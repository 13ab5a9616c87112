"""Data of a real rig: its log, frames and camera, checked and made a data set."""
