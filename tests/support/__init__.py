"""What tests and benchmarks share: processes on a router, clients, stand-ins, and second opinions."""
