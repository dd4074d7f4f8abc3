"""Replays of recordings of servers: the same requests and states, with the replies of the present version."""
