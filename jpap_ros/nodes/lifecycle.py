"""A lifecycle node that brings itself up, and says why where a transition fails."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from jpap_ros.fleet.config import FleetFileError
from jpap_ros.nodes.parameters import StartError


class ManagedNode(LifecycleNode):
    """A lifecycle node whose transitions are four plain methods that raise when they fail.

    Subclasses override `configure`, `activate`, `deactivate` and `cleanup`. rclpy itself drops the exception of a
    failed transition; here it is logged, or raised by `bring_up`.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self._failure: Exception | None = None
        self._bringing_up = False
        self.active = False

    def configure(self) -> None:
        """Make publishers, subscriptions and services."""

    def activate(self) -> None:
        """Begin to work."""

    def deactivate(self) -> None:
        """Stop working; keep what is known."""

    def cleanup(self) -> None:
        """Undo `configure`."""

    def bring_up(self) -> None:
        """Configure and activate, as a lifecycle manager would.

        Raises
        ------
        Exception
            What `configure` or `activate` raised.
        """
        self._bringing_up = True
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() != TransitionCallbackReturn.SUCCESS:
                raise self._failure or StartError(f"{self.get_name()} could not be configured and activated")
        self._bringing_up = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure; on a failure the node stays unconfigured."""
        try:
            self.configure()
        except Exception as error:
            self._keep_failure("configure", error)
            self.cleanup()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate; on a failure the node stays inactive."""
        # Lifecycle publishers first: activating may publish.
        result = super().on_activate(state)
        self.active = True
        try:
            self.activate()
        except Exception as error:
            self._keep_failure("activate", error)
            self.active = False
            super().on_deactivate(state)
            return TransitionCallbackReturn.FAILURE
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        self.active = False
        self.deactivate()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up."""
        self.cleanup()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working and clean up, from whatever state."""
        if self.active:
            self.on_deactivate(state)
        self.cleanup()
        return super().on_shutdown(state)

    def _keep_failure(self, what: str, error: Exception) -> None:
        self._failure = error
        if self._bringing_up:
            return
        expected = isinstance(error, (StartError, FleetFileError))
        self.get_logger().error(f"cannot {what}: {error}" if expected else f"cannot {what}: {error!r}")
