"""The client: requests, control streams, plans and the watchdog."""
