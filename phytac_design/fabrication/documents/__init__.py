"""Papers for the bench: paint map, placement of switches, bill of materials, recipe, assembly."""
