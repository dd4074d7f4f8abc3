"""Gloves: calibration from paired postures, drift, and the mapping of fingertips to another hand.

- `frames`: recorded and live frames of a glove
- `calibration`: joint positions from the readings of a glove's sensors
- `simulated_glove`: a glove with cross-talk, noise and drift
- `fingertip_mapping`: the posture of another hand with corresponding fingertips
- `teleoperation`: the desired motion of a held object, or of a hand, from an operator's poses
- `glove_inputs`: a glove as an input of control streams
"""
