"""`fringed`, the daemon's program: hands the command line to `fringed.cli`."""

from __future__ import annotations

from fringed.cli.main import main

__all__ = ["main"]

if __name__ == "__main__":
    main()
