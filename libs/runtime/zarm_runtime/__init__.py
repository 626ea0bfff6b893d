"""What every process on the bus needs: sessions, queries, publications, services, state files, logs, records."""
