"""What makes things go wrong, and what is checked afterwards."""
