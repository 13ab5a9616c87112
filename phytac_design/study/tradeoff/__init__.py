"""The trade of time for truth: every knob measured, and settings chosen by what they lose."""
