"""Motions of fingers in a recording, their order, and how common an order is.

- `meta_motions`: the nine kinds of motion of a finger
- `segmentation`: the motions of a finger in a stream of joint positions
- `gist_ranking`: histogram and ranking of the orders of motions of several recordings
- `finger_angles`: the four angles of a finger from the joint positions of a hand
- `labels`: the motions of all fingers of a recording or of a running stream, with their times
- `retrieval`: recordings with a similar order of motions
- `recorded_motion`: the object's motion in a recording, for another object of another size

Source: HANDLE project, Parameterizing and creating new actions (undated), section 5.
"""
