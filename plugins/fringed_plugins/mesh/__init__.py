"""Point clouds and meshes as files' bytes, and the mesh of a grid. Knows no contract and no file system."""
