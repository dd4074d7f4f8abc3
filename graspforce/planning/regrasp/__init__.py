"""Regrasping: moves of a held object beyond the reach of one grasp, with fingers that step while the others hold."""
