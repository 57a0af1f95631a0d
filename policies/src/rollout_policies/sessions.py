"""The episodes under way: a bounded table, which forgets those that nobody
ended. What happens to a forgotten one is the caller's affair."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from .episode import Episode
from .proto import policy_pb2 as pb

#: Episodes remembered; the one idle for longest is forgotten first.
MAX_SESSIONS = 1024
#: An episode without a call for so long is over, if nobody said so before.
IDLE_SECS = 900.0


@dataclass
class Session:
    """One episode and its last answer."""

    episode: Episode
    next_query: int = 0
    #: The last query and its answer. One attribute, because threads that look
    #: for a retry's answer read it while another writes.
    last: tuple[int, pb.InferResponse] | None = None
    #: Actions answered that are executed, and whether one opened the gripper.
    executed: int = 0
    opened: bool = False
    used_at: float = 0.0


    def answered(self, query_index: int) -> pb.InferResponse | None:
        """The answer to a query, if it was the last one."""
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
        # The one idle for longest comes first.
        self._sessions: OrderedDict[str, Session] = OrderedDict()

    def __len__(self) -> int:
        return len(self._sessions)

    def open(self, session: Session) -> list[Session]:
        """Adds a session; returns those that had to go for it."""
        with self._lock:
            session.used_at = self._clock()
            self._sessions[session.episode.session] = session
            self._sessions.move_to_end(session.episode.session)
            over = max(0, len(self._sessions) - self._most)
            return [self._sessions.popitem(last=False)[1] for _ in range(over)]

    def get(self, name: str) -> Session | None:
        """A session that is open, which is not idle now."""
        with self._lock:
            session = self._sessions.get(name)
            if session is not None:
                session.used_at = self._clock()
                self._sessions.move_to_end(name)
            return session

    def close(self, name: str) -> Session | None:
        """Takes a session out, if it is open."""
        with self._lock:
            return self._sessions.pop(name, None)

    def close_idle(self) -> list[Session]:
        """Takes out the sessions that nothing was heard of for too long."""
        gone = []
        with self._lock:
            latest = self._clock() - self._idle_secs
            while self._sessions and next(iter(self._sessions.values())).used_at < latest:
                gone.append(self._sessions.popitem(last=False)[1])
        return gone
