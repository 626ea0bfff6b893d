"""Programs that tests start by path as separate processes: they import nothing of support."""
