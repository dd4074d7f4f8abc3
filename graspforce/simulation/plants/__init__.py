"""Plants: hand and object in MuJoCo, from a scene or from the URDF, with options, preload and disturbances."""
