"""JSON Schemas of the records of the wire, and the types from which they are generated."""
