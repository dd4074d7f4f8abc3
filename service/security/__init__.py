"""TLS certificates and access rules of a service and its clients."""
