"""placeholder until merge"""

import numpy as np


def grasp_matrix(contacts):
    return contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, contacts.columns]


def characteristic_length(contacts):
    p = contacts.p_OC
    for r in (p - p.mean(0), p):
        L = float(np.sqrt((r**2).sum(1).mean()))
        if L > 0:
            return L
    return 1.0
