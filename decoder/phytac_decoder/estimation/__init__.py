"""From marker displacements to contacts and forces."""
