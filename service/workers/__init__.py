"""Planning processes and the server's handle of them."""
