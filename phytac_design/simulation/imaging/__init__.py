"""How a virtual sensor is seen: by frames, or by points that behave as if from frames."""
