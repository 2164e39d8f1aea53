"""Faces for other libraries, a module each that imports the library it is for: `docs/adapters.md`."""
