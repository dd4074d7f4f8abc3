"""The fastest move between two poses, with the object's path optimised too."""
