"""How far a running goal may go, and another trajectory where it is blocked."""
