"""One module a file format, each with ``parse``."""
