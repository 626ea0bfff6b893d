"""What crosses the wire between zarm's processes, and nothing else."""
