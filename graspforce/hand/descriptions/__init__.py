"""Descriptions of hands as files: URDF, drives, tendons, and the JSON record with its schema."""
