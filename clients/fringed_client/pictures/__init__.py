"""Pictures of what a station measured: thumbnails, maps with axes and units, shaded views, error maps."""
