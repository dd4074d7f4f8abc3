"""A node of ROS 2 without ROS: messages, services and discovery as rmw_zenoh has them, over plain Zenoh."""
