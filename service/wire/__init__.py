"""The wire: keys, codecs, envelopes, and the records of requests and answers."""
