"""Motions of fingers in a recording, their order, and how common an order is.

- `meta_motions`: the nine kinds of motion of a finger
- `segmentation`: the motions of a finger in a stream of joint positions
- `gist_ranking`: histogram and ranking of the orders of motions of several recordings

Source: HANDLE project, Parameterizing and creating new actions (undated), section 5.
"""
