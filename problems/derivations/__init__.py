"""Where the cases come from: each module states a collection's records, with the derivation of every answer."""
