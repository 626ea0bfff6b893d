"""The scene: its store, its edits, and how plans see it."""
