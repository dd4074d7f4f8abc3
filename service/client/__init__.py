"""The client: requests, control streams and the watchdog."""
