"""Tools for agents over the Model Context Protocol, inside a policy."""
