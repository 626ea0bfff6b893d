"""The executor: a client, benches without a bus, and a robot behind a driver as processes."""
