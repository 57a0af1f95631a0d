"""The table of open episodes. It is bounded in number and idle time, because callers may fail to
end an episode; a removed episode is returned, so that the service can end it."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from .episode import Episode
from .proto import policy_pb2 as pb

#: Largest number of open episodes. Beyond it, the episode idle for longest is removed.
MAX_SESSIONS = 1024
#: Idle time after which an episode counts as over, unless a caller ended it before.
IDLE_SECS = 900.0


@dataclass
class Session:
    """One episode and its last answer."""

    episode: Episode
    next_query: int = 0
    #: The last query and its answer, in one attribute because threads that handle a retry read it
    #: while another thread writes it.
    last: tuple[int, pb.InferResponse] | None = None
    #: Number of executed actions in all answers; and True if one of these actions opened the
    #: gripper.
    executed: int = 0
    gripper_opened: bool = False
    #: Time of the last use, s, by the table's clock.
    used_at: float = 0.0

    def answered(self, query_index: int) -> pb.InferResponse | None:
        """Returns the answer to a query, if it was the last query."""
        last = self.last
        return last[1] if last is not None and last[0] == query_index else None


class SessionTable:
    """Sessions by name. Safe to use from several threads."""

    def __init__(
        self,
        most: int = MAX_SESSIONS,
        idle_secs: float = IDLE_SECS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._most = most
        self._idle_secs = idle_secs
        self._clock = clock
        self._lock = threading.Lock()
        # Ordered by last use: the session idle for longest is first.
        self._sessions: OrderedDict[str, Session] = OrderedDict()

    def __len__(self) -> int:
        return len(self._sessions)

    def open(self, session: Session) -> list[Session]:
        """Adds a session and returns those that were removed to make room."""
        with self._lock:
            session.used_at = self._clock()
            self._sessions[session.episode.session] = session
            self._sessions.move_to_end(session.episode.session)
            excess = max(0, len(self._sessions) - self._most)
            return [self._sessions.popitem(last=False)[1] for _ in range(excess)]

    def get(self, name: str) -> Session | None:
        """Returns an open session and resets its idle time."""
        with self._lock:
            session = self._sessions.get(name)
            if session is not None:
                session.used_at = self._clock()
                self._sessions.move_to_end(name)
            return session

    def close(self, name: str) -> Session | None:
        """Removes and returns a session, if it is open."""
        with self._lock:
            return self._sessions.pop(name, None)

    def close_idle(self) -> list[Session]:
        """Removes and returns the sessions that have been idle for too long."""
        removed = []
        with self._lock:
            latest = self._clock() - self._idle_secs
            while self._sessions and next(iter(self._sessions.values())).used_at < latest:
                removed.append(self._sessions.popitem(last=False)[1])
        return removed
