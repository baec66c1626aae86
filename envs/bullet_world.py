"""The simulated world in Bullet."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.bullet_camera import Camera
from sb3_stereo.envs.bullet_scene import BulletScene, add_floor, empty_world, paint_floor
from sb3_stereo.envs.clutter import Item
from sb3_stereo.envs.specs import quoted, require
from sb3_stereo.envs.world import World


class BulletWorld(World):
    """A `World` in a Bullet client of its own. A state is Bullet's number of it, of no use in another client."""

    def _build(self) -> tuple[Arm, tuple[Camera, ...], BulletScene]:
        self._client = client = empty_world(self.in_window, self.physics_rate, self.weightless)
        cameras = tuple(Camera(view, client) for view in self.views)
        self._ground = ground = add_floor(client, cameras, drawn=self.floor, in_window=self.in_window)
        arm = Arm(self.arm_spec, client)
        for link in arm.fixed_links:  # what stands on the floor touches it in every pose
            client.setCollisionFilterPair(ground, arm.body, -1, link, 0)
        self._arm_body = arm.body
        if self.damping is not None:
            arm.set_damping(self.damping)
        radii, hollow = self.markers.radii(self.arm_spec), self.markers.hollow_target
        self._things = BulletScene(client, ground, radii, hollow, self.n_things, self.clutter)
        return arm, cameras, self._things

    def _finish_building(self) -> None:
        self._pristine, self._start = self._client.saveState(), self._client.saveState()

    def _set_gravity(self, gravity: Sequence[float]) -> None:
        self._client.setGravity(*gravity)

    def _draw_floor(self, colour: Sequence[float] | None) -> None:
        paint_floor(self._client, self._ground, colour)

    def _begin_with(self, items: Sequence[Item], obstacles: Sequence[Item]) -> None:
        self._client.removeState(self._start)
        self._client.restoreState(self._pristine)
        self._things.place_things(items, obstacles)
        self._start = self._client.saveState()

    def _move(self, obstacles: Sequence[Item]) -> None:
        self._things.move(obstacles)

    def _is_near_arm(self, obstacle: Item, distance: float) -> bool:
        self._things.move([obstacle])
        body = self._things.obstacles[obstacle.number]
        return bool(self._client.getClosestPoints(self._arm_body, body, distance))

    def _rewind(self) -> None:
        self._client.restoreState(self._start)

    def _state(self) -> int:
        return int(self._client.saveState())

    def _set_state(self, state: int) -> None:
        self._client.restoreState(state)

    def _free_state(self, state: int) -> None:
        self._client.removeState(state)

    def _record(self) -> bytes:
        way_out = "copy one with render_mode None or 'rgb_array'"
        require(not self.in_window, f"an environment in Bullet's window (render_mode 'human') has no copies; {way_out}")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "state.bullet"  # the only form that another client takes
            self._client.saveBullet(str(file))
            return file.read_bytes()

    def _set_record(self, record: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "state.bullet"
            file.write_bytes(record)
            try:
                self._client.restoreState(fileName=str(file))
            except pybullet.error as error:
                urdf = quoted(self.arm_spec.urdf)
                raise ValueError(f"{urdf} has changed since the environment was pickled; pickle it again") from error

    def keyboard_events(self) -> dict[int, int] | None:
        """As in `World`."""
        try:
            return dict(self._client.getKeyboardEvents())
        except pybullet.error:
            return None

    def close(self) -> None:
        """Disconnect from Bullet; a second call does nothing."""
        self._client.close()
