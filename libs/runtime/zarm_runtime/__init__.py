"""What every process needs to live on the bus: sessions, queries and publications, the frame of a service, state, logs, records."""
