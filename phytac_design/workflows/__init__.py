"""Work that runs stages of a build: simulate, train, evaluate, import a rig's data."""
