"""Recordings of a server: its requests, states and replies as an MCAP file."""
