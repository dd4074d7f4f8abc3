"""MuJoCo as the plant: a hand that holds an object in a physics engine that is not ours. Never part of an answer."""
