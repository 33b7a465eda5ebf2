"""What docs/architecture.md adds to radioloc, as a package of its own; tests/unit/test_plugins.py runs it."""
