"""Files of points and triangles: what simulated objects and registration read; `mesh` of the plug-ins writes them."""
