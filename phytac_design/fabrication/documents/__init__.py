"""Documents for the workbench: paint map, placement table, bill of materials, recipe, assembly."""
