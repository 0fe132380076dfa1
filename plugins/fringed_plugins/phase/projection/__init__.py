"""What is projected: profiles, grey levels, dithering, codes, and which frequencies suit. Knows no contract."""
