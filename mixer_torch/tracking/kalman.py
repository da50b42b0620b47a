"""Kalman filter of almost constant velocities, compiled: one short run for each observation."""

from __future__ import annotations

import numpy as np

from mixer_torch.solvers.compiled import compiled


@compiled
def filter_each(before, position, variance, time, jolt, flat):  # type: ignore[no-untyped-def]
    """Position, velocity and their covariance at each observation, judged by those before it.

    On each axis apart, from the earliest on:

        predict   x += v dt,   P += [[2 dt P_xv + dt^2 P_vv, dt P_vv], [., 0]] + Q(dt)
        update    K = P_x / (P_xx + variance),   x, v += K (z - x),   P -= K P_x'

    with Q(dt) = jolt [[|dt|^3 / 3, dt |dt| / 2], [., |dt|]], of the observation that is judged.

    Args:
        before: (m, K) int64, those before each observation, latest first; -1 for none.
        position: (m, axes) what was measured.
        variance: (m, axes) of its error.
        time: (m,) seconds; backwards in time where those "before" are later.
        jolt: (m, axes) variance by which a velocity changes in a second.
        flat: (m, axes) variance of the velocity before anything is known of it.

    Returns:
        (m, axes, 5): x, v, P_xx, P_xv, P_vv.
    """
    m, axes = position.shape
    found = np.empty((m, axes, 5))
    for i in range(m):
        for axis in range(axes):
            q = jolt[i, axis]
            x, v, xx, xv, vv = 0.0, 0.0, 0.0, 0.0, flat[i, axis]
            now, started = time[i], False
            for step in range(before.shape[1] - 1, -2, -1):
                j = i if step < 0 else before[i, step]
                if j < 0:
                    continue
                error = variance[j, axis]
                if not started:
                    x, xx, started = position[j, axis], error, True
                else:
                    dt = time[j] - now
                    far = abs(dt)
                    x += v * dt
                    xx += 2 * dt * xv + dt * dt * vv + q * far * far * far / 3
                    xv += dt * vv + q * dt * far / 2
                    vv += q * far
                    total = xx + error
                    surprise = position[j, axis] - x
                    x += xx / total * surprise
                    v += xv / total * surprise
                    vv -= xv * xv / total
                    xv *= error / total
                    xx *= error / total
                now = time[j]
            found[i, axis] = x, v, xx, xv, vv
    return found
