"""Large displacement: corotational kinematics, path following, when it is needed."""
