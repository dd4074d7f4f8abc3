"""Pictures and films of a simulated hand."""
