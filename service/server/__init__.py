"""The server: requests, streams and plans."""
