"""Planning of contact forces in a control step, with margins and worst cases."""
