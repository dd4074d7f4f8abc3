"""The server: queues, requests, control streams and plans."""
