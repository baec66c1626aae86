"""Viscous damping of joints that are too light for Bullet's own.

Bullet's damping is a torque computed from the speed before the step. A joint that feels the inertia I then loses the
fraction damping * time step / I of its speed in a step: more than one overshoots, more than two diverges. With
8 N m s/rad that is an inertia below 0.02 kg m^2 at 240 Hz, and the joints of a desktop arm feel 1e-4.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MAX_EXPLICIT_LOSS = 1.5  # between 1 and 2, as the poses that were tried are not all


class JointSpace:
    """What the actuated joints feel: the moving joints with those held as rigid and those geared to them coupled.

    Args:
        client: A `BulletClient`.
        body: The robot, whose base does not move.
        moving: Its moving joints, in Bullet's order.
        gearing: How far each turns per actuated joint, shape (n_moving, n_joints).
        drives: Inertia added to links, as (link, about its principal axes, shape (3,), in [kg m^2]). Bullet's inverse
            dynamics does not know it: it keeps what it read first, and refuses tensors that no mass distribution has.
    """

    def __init__(
        self, client: Any, body: int, moving: list[int], gearing: Floats, drives: Sequence[tuple[int, Floats]]
    ) -> None:
        self._client, self._body, self._moving = client, body, moving
        self._gearing, self._drives = gearing, drives
        parameters = client.getPhysicsEngineParameters()
        gravity = np.array([parameters[f"gravityAcceleration{axis}"] for axis in "XYZ"])
        orientation = client.getBasePositionAndOrientation(body)[1]
        self._base_to_world = np.reshape(client.getMatrixFromQuaternion(orientation), (3, 3))
        # Bullet's inverse dynamics takes gravity for a vector of the base.
        self._gravity, self._base_gravity = gravity.tolist(), (self._base_to_world.T @ gravity).tolist()
        self._tilted = not np.allclose(self._gravity, self._base_gravity)

    def inertia(self, positions: list[float]) -> Floats:
        """Mass matrix of the actuated joints, (n_joints, n_joints), of the pose that the arm is in.

        Args:
            positions: Of the moving joints.
        """
        mass = np.array(self._client.calculateMassMatrix(self._body, positions))
        still = [0.0] * len(positions)
        for link, inertia in self._drives:
            jacobian = self._client.calculateJacobian(self._body, link, [0.0, 0.0, 0.0], positions, still, still)[1]
            orientation = self._client.getLinkState(self._body, link, computeForwardKinematics=True)[1]
            link_to_world = np.reshape(self._client.getMatrixFromQuaternion(orientation), (3, 3))
            turning = (self._base_to_world.T @ link_to_world).T @ np.array(jacobian)  # about the principal axes
            mass += turning.T @ (inertia[:, None] * turning)
        return np.asarray(self._gearing.T @ mass @ self._gearing)

    def bias(self, positions: list[float], speeds: list[float]) -> Floats:
        """Efforts that would keep the actuated joints at their speeds, (n_joints,): gravity and gyroscopic terms."""
        if self._tilted:
            self._client.setGravity(*self._base_gravity)
        bias = self._client.calculateInverseDynamics(self._body, positions, speeds, [0.0] * len(positions))
        if self._tilted:
            self._client.setGravity(*self._gravity)
        return np.asarray(self._gearing.T @ np.array(bias))

    def state(self) -> tuple[list[float], list[float]]:
        """Positions and speeds of the moving joints."""
        states = self._client.getJointStates(self._body, self._moving)
        return [state[0] for state in states], [state[1] for state in states]


class ImplicitDamping:
    """Damping by the speed after the step, which is stable for any inertia and time step.

    With the mass matrix M, the damping D and the bias c, the speed v' after a step of h seconds solves
    (M + h D) v' = M v + h (efforts - c), and Bullet gets there by the efforts M (v' - v) / h + c (semi-implicit Euler).
    A joint that would pass a stop is taken to it instead: left to Bullet, the stop's impulse would reach the other
    joints undamped. A contact's does, so what a collision does to the rest of a light arm is exaggerated.

    Args:
        space: Of the arm.
        actuated: Which of the moving joints act.
        stops: Lowest and highest position of each of these, infinite without one, shape (n_joints, 2).
        damping: Of each of these, in [N m s/rad].
        time_step: In [s].
    """

    def __init__(
        self, space: JointSpace, actuated: list[int], stops: Floats, damping: Floats, time_step: float
    ) -> None:
        self._space, self._actuated, self._stops = space, actuated, stops
        self._damping, self._time_step = damping, time_step

    def damped(self, efforts: Sequence[float]) -> list[float]:
        """Efforts for the next step that are those given less the damping's."""
        positions, speeds = self._space.state()
        inertia, bias = self._space.inertia(positions), self._space.bias(positions, speeds)
        speed, step = np.array(speeds)[self._actuated], self._time_step
        slowest, fastest = (self._stops - np.array(positions)[self._actuated, None]).T / step
        after = _limited_solution(
            inertia + step * np.diag(self._damping),
            inertia @ speed + step * (np.array(efforts) - bias),
            slowest,
            fastest,
        )
        damped: list[float] = (inertia @ (after - speed) / step + bias).tolist()
        return damped


def _limited_solution(matrix: Floats, right: Floats, low: Floats, high: Floats) -> Floats:
    """Solve for speeds; those outside their bounds are put there, and the others solved for again."""
    speeds = np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    bound = np.zeros(len(right), dtype=bool)
    while (outside := ~bound & ((speeds < low) | (speeds > high))).any():
        bound |= outside
        speeds[bound] = np.clip(speeds, low, high)[bound]
        free = ~bound
        known = matrix[np.ix_(free, bound)] @ speeds[bound]
        speeds[free] = np.linalg.solve(matrix[np.ix_(free, free)], right[free] - known)
    return speeds


def explicit_loss(inertia: Floats, damping: Floats, time_step: float) -> float:
    """Largest fraction of its speed that a motion loses in a step of explicit damping; above 2 it diverges."""
    root = np.sqrt(damping)
    return float(np.linalg.eigvalsh(root[:, None] * np.linalg.inv(inertia) * root).max()) * time_step
