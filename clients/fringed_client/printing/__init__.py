"""Boards on paper, at exact scale: what stands where on a page, and PDF and SVG of it."""
