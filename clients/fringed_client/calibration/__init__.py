"""Calibration from the client's side: poses of a board, the order of a session, its report."""
