"""Compensation of joint friction: feed-forward, feedback levels and the disturbance observer."""
