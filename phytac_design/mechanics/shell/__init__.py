"""The linear shell: element, solver, loads, compliance."""
