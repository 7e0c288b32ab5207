"""Ctrl-C ends native calls, and what was done until then is kept."""

import signal
import threading

import numpy as np
import pytest

import propwash


class Soon:
    """Sends this process a Ctrl-C as long as the block runs, every tenth of a second: the first may come before the call."""

    def __enter__(self):
        self.over = threading.Event()
        self.thread = threading.Thread(target=self.send)
        self.thread.start()

    def send(self):
        while not self.over.wait(0.1):
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()


@pytest.fixture
def once(monkeypatch):
    """A handler that raises once, so that the later signals of a test do no harm."""
    raised = []

    def handle(*_):
        if not raised:
            raised.append(True)
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, handle)
    yield
    signal.signal(signal.SIGINT, before)


def test_steps_end_between_two_and_the_simulation_goes_on(once):
    sim = propwash.Sim(256)
    sim.reset()
    with Soon(), pytest.raises(KeyboardInterrupt):
        sim.step(1_000_000_000)
    flown = int(sim.data.steps[0])
    assert 0 < flown < 1_000_000_000 and (sim.data.steps == flown).all()
    sim.step(10)
    assert (sim.data.steps == flown + 10).all() and not sim.quarantined.any()


def test_steps_with_a_stage_end_too(once):
    sim = propwash.Sim(2)
    sim.pipeline.append("count", lambda data: None)
    sim.reset()
    with Soon(), pytest.raises(KeyboardInterrupt):
        sim.step(1_000_000_000)
    assert 0 < sim.data.steps[0] < 1_000_000_000


def test_a_data_set_keeps_its_worlds_and_is_completed_by_the_same_call(once, tmp_path):
    whole = {"scene": "room", "n_worlds": 6, "seconds": 0.2, "fps": 10}
    told = []

    def stop(done, all_worlds):
        told.append((done, all_worlds))
        if done >= 2:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        propwash.fly(tmp_path / "set", **whole, threads=1, progress=stop)
    assert told[-1][0] < 6 and told[-1][1] == 6
    flown = propwash.fly(tmp_path / "set", **whole)
    assert flown.resumed_worlds >= 2
    propwash.fly(tmp_path / "other", **whole)
    names = sorted(p.relative_to(tmp_path / "set") for p in (tmp_path / "set").rglob("*") if p.is_file())
    assert names == sorted(p.relative_to(tmp_path / "other") for p in (tmp_path / "other").rglob("*") if p.is_file())
    assert all((tmp_path / "set" / n).read_bytes() == (tmp_path / "other" / n).read_bytes() for n in names)
    # A flight of hours.
    with Soon(), pytest.raises(KeyboardInterrupt):
        propwash.fly(tmp_path / "long", **{**whole, "seconds": 1e5, "fps": 1})


def test_an_analysis_ends(once):
    with Soon(), pytest.raises(KeyboardInterrupt):
        while True:
            propwash.excite("cf2x_L250", ["linear_drag", "payload"], seconds=60.0)


def test_long_rollouts_end(once):
    sim = propwash.Sim(3, control="state")
    # 420 million steps of drones, of which ten million make a part.
    commands = np.zeros((3, 14_000, 1, 16))
    with Soon(), pytest.raises(KeyboardInterrupt):
        sim.rollout(commands, 10_000)
