"""Programs that tests start as processes of their own, by path: they import nothing of support."""
