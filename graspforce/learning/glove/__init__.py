"""Gloves: calibration from paired postures, drift, and the mapping of fingertips to another hand.

- `calibration`: joint positions from the readings of a glove's sensors
- `simulated_glove`: a glove with cross-talk, noise and drift
- `fingertip_mapping`: the posture of another hand with corresponding fingertips
- `teleoperation`: the desired motion of a held object from an operator's poses
"""
