"""The studio: a design with controls in a browser of this machine; a thin face of the library."""
