"""Records of the wire and their codecs."""
