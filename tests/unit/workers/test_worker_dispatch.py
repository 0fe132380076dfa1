"""The dispatcher, event by event; time is a number."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from fringed.data import Mesh
from fringed.errors import Quarantined, UsageError
from fringed.messages import (
    ErrorInfo,
    Job,
    JobCancel,
    JobDone,
    JobFailed,
    JobProgress,
    Request,
    StageCall,
    StageDone,
    WorkerAlive,
    WorkerReady,
    WorkerStop,
)
from fringed.workers.dispatch import Dispatcher
from fringed.workers.jobs import Limits, Watcher, subject_of

LIMITS = Limits(attempts=3, job_timeout_s=10.0, cancel_grace_s=2.0, silence_s=5.0)
SCHEMAS = {"processor": {"decode": {}, "triangulate": {}}}


def mesh(name: str) -> Mesh:
    return Mesh(np.zeros((3, 3)), np.zeros((1, 3), np.int32), id=name)


def job(name: str, subject: str = "set-1", pipeline: str = "p", plugins: tuple[str, ...] = ("decode",)) -> Job:
    stages = tuple(StageCall(plugin, "processor", plugin) for plugin in plugins)
    return Job(name, stages, {"object": mesh(subject)}, pipeline)


@dataclass
class Log:
    events: list[tuple] = field(default_factory=list)

    def watcher(self) -> Watcher:
        return Watcher(
            lambda done: self.events.append(("stage", done.stage)),
            lambda _: self.events.append(("done",)),
            lambda error, quarantined: self.events.append(("failed", error.code, quarantined)),
            lambda progress: self.events.append(("progress", progress.fraction)),
        )

    @property
    def end(self) -> tuple | None:
        return next((e for e in self.events if e[0] in {"done", "failed"}), None)


class Bench:
    """A dispatcher with its clock, and what it sent."""

    def __init__(self, *workers: str) -> None:
        self.now = 0.0
        self.it = Dispatcher(LIMITS)
        for worker in workers:
            self.ready(worker)

    def ready(self, worker: str, credits: int = 1, schemas: dict = SCHEMAS) -> None:
        self.say(worker, WorkerReady(worker, 1, credits, schemas=schemas))

    def say(self, worker: str, message: object) -> None:
        self.it.received(worker, message, self.now)

    def submit(self, what: Job, timeout_s: float | None = None) -> Log:
        log = Log()
        self.it.submit(what, log.watcher(), self.now, timeout_s)
        return log

    def sent(self) -> list[tuple[str, object]]:
        return self.it.take_outbox()

    def jobs_sent(self) -> list[tuple[str, str]]:
        return [(worker, message.id) for worker, message in self.sent() if isinstance(message, Job)]

    def complete(self, worker: str, what: str, *stages: str) -> None:
        for stage in stages or ("decode",):
            self.say(worker, StageDone(what, stage, 0.1, mesh("product")))
        self.say(worker, JobDone(what))

    def pass_time(self, seconds: float, *alive: str) -> None:
        """Let time pass in steps of a second in which `alive` show that they are."""
        for _ in range(round(seconds)):
            self.now += 1.0
            for worker in alive:
                self.say(worker, WorkerAlive(worker))
            self.it.tick(self.now)


def test_job_goes_to_a_worker_and_its_answer_to_the_watcher():
    bench = Bench("a")
    log = bench.submit(job("j"))
    assert bench.jobs_sent() == [("a", "j")]
    bench.say("a", JobProgress("j", 0.5))
    bench.complete("a", "j")
    assert log.events == [("progress", 0.5), ("stage", "decode"), ("done",)]
    assert bench.it.active == ()


def test_job_waits_for_a_credit():
    bench = Bench("a")
    bench.submit(job("j1"))
    bench.submit(job("j2"))
    assert bench.jobs_sent() == [("a", "j1")]
    assert bench.it.waiting == 1
    bench.complete("a", "j1")
    assert bench.jobs_sent() == [("a", "j2")]


def test_worker_with_two_credits_gets_two_jobs():
    bench = Bench()
    bench.ready("a", credits=2)
    for name in ("j1", "j2", "j3"):
        bench.submit(job(name))
    assert bench.jobs_sent() == [("a", "j1"), ("a", "j2")]


def test_zero_credits_drain_a_worker():
    bench = Bench("a")
    bench.submit(job("j1"))
    bench.ready("a", credits=0)
    bench.complete("a", "j1")
    bench.submit(job("j2"))
    assert bench.jobs_sent() == [("a", "j1")]
    assert bench.it.peers["a"].credits == 0


def test_job_goes_to_the_worker_that_has_the_plugin():
    bench = Bench()
    bench.ready("a", schemas={"processor": {"other": {}}})
    bench.ready("b")
    bench.submit(job("j"))
    assert bench.jobs_sent() == [("b", "j")]


def test_unknown_plugin_is_left_to_a_worker_that_tells_which_there_are():
    bench = Bench("a")
    log = bench.submit(job("j", plugins=("nonsense",)))
    assert bench.jobs_sent() == [("a", "j")]
    bench.say("a", JobFailed("j", "nonsense", ErrorInfo("NotFound", "no such"), retry=False))
    assert log.end == ("failed", "NotFound", False)
    assert bench.it.quarantine.entries == ()


def test_lost_worker_s_job_goes_to_another():
    bench = Bench("a", "b")
    log = bench.submit(job("j"))
    [(first, _)] = bench.jobs_sent()
    bench.it.lost(first, "was killed by SIGSEGV in stage decode", bench.now)
    [(second, _)] = bench.jobs_sent()
    assert {first, second} == {"a", "b"}
    bench.complete(second, "j")
    assert log.end == ("done",)


def test_retry_prefers_another_worker():
    bench = Bench("a")
    bench.submit(job("j"))
    bench.ready("b")
    bench.sent()
    bench.say("a", JobFailed("j", "decode", ErrorInfo("PluginError", "x")))
    assert bench.jobs_sent() == [("b", "j")]


def test_nobody_is_blamed_for_a_worker_that_was_ended_on_purpose():
    bench = Bench("a")
    log = bench.submit(job("j"))
    for _ in range(5):
        bench.it.lost("a", "was ended to load its plug-ins anew", bench.now, blame=False)
        bench.ready("a")
    assert bench.it.counters["attempts_failed"] == 0
    bench.complete("a", "j")
    assert log.end == ("done",)


def test_only_the_job_in_progress_is_blamed_for_a_lost_worker():
    bench = Bench()
    bench.ready("a", credits=3)
    logs = [bench.submit(job(f"j{i}", f"set-{i}")) for i in range(3)]
    for attempt in range(3):
        bench.it.lost("a", "died", bench.now)
        bench.ready("a", credits=3)
        assert bench.it.counters["attempts_failed"] == attempt + 1
    assert logs[0].end == ("failed", "Quarantined", True)
    assert logs[1].end is None
    assert [entry.subject for entry in bench.it.quarantine.entries] == ["set-0"]


@pytest.mark.parametrize("kind", ["lost", "raised", "silent", "overtime"])
def test_repeated_failure_is_quarantined_with_its_reason(kind):
    bench = Bench()
    log = bench.submit(job("j"))
    for attempt in range(3):
        assert log.end is None, attempt
        worker = "w" if kind == "raised" else f"w{attempt}"
        if worker not in bench.it.peers:
            bench.ready(worker)
        if kind == "lost":
            bench.it.lost(worker, "was killed by SIGSEGV", bench.now)
        elif kind == "raised":
            bench.say(worker, JobFailed("j", "decode", ErrorInfo("PluginError", "it raised")))
        elif kind == "silent":
            bench.pass_time(7)
        else:
            bench.pass_time(14, worker)
    reason = {"lost": "SIGSEGV", "raised": "it raised", "silent": "silent for", "overtime": "longer than 10 s"}[kind]
    assert log.end == ("failed", "Quarantined", True)
    [entry] = bench.it.quarantine.entries
    assert (entry.subject, entry.pipeline, entry.attempts) == ("set-1", "p", 3)
    assert reason in entry.reason


def quarantined() -> Bench:
    bench = Bench()
    bench.submit(job("j"))
    for _ in range(3):
        bench.ready("a")
        bench.it.lost("a", "exited with status 7", bench.now)
    bench.ready("b")
    bench.sent()
    return bench


def test_quarantined_subject_is_refused_at_once_until_cleared():
    bench = quarantined()
    with pytest.raises(Quarantined, match=r"set-1 with pipeline 'p'.*exited with status 7.*quarantine\.clear"):
        bench.submit(job("again"))
    assert bench.it.quarantine.clear("another") == 0
    assert bench.it.quarantine.clear("set-1") == 1
    bench.submit(job("again"))
    assert bench.jobs_sent() == [("b", "again")]


def test_other_sets_and_other_pipelines_go_on():
    bench = quarantined()
    bench.submit(job("other-pipeline", pipeline="q"))
    bench.complete("b", "other-pipeline")
    bench.submit(job("other-set", subject="set-2"))
    assert bench.jobs_sent() == [("b", "other-pipeline"), ("b", "other-set")]


def test_stages_outside_pipelines_are_quarantined_by_their_plugins():
    bench = Bench()
    bench.submit(job("j", pipeline=""))
    for _ in range(3):
        bench.ready("a")
        bench.it.lost("a", "died", bench.now)
    [entry] = bench.it.quarantine.entries
    assert entry.pipeline == "processor/decode"
    bench.submit(job("k", pipeline="", plugins=("triangulate",)))
    assert bench.it.waiting == 1


def test_queued_job_of_a_subject_quarantined_meanwhile_is_refused():
    bench = Bench()
    bench.submit(job("j"))
    second = bench.submit(job("k"))
    for _ in range(3):
        bench.ready("a")
        bench.it.lost("a", "died", bench.now)
    assert second.end == ("failed", "Quarantined", True)


def test_success_forgets_earlier_failures():
    bench = Bench()
    for number in range(4):
        log = bench.submit(job(f"j{number}"))
        for _ in range(2):
            bench.ready("a")
            bench.it.lost("a", "died", bench.now)
        bench.ready("a")
        bench.complete("a", f"j{number}")
        assert log.end == ("done",)
        bench.it.lost("a", "went home", bench.now)
    assert bench.it.quarantine.entries == ()


def test_deliberate_refusal_fails_at_once_without_a_mark():
    bench = Bench("a")
    for number in range(4):
        log = bench.submit(job(f"j{number}"))
        bench.say("a", JobFailed(f"j{number}", "decode", ErrorInfo("DataError", "too dark"), retry=False))
        assert log.end == ("failed", "DataError", False)
    assert bench.it.quarantine.entries == ()


def test_overtime_asks_first_then_condemns():
    bench = Bench("a")
    bench.submit(job("j"))
    bench.sent()
    bench.pass_time(11, "a")
    assert ("a", JobCancel("j")) in bench.sent()
    assert bench.it.take_condemned() == []
    bench.pass_time(2, "a")
    [(worker, reason)] = bench.it.take_condemned()
    assert worker == "a"
    assert "longer than 10 s" in reason
    assert ("a", WorkerStop(reason)) in bench.sent()


def test_plugin_that_stops_when_overtime_keeps_its_worker():
    bench = Bench("a")
    bench.submit(job("j"))
    bench.pass_time(11, "a")
    bench.say("a", JobFailed("j", "decode", ErrorInfo("Cancelled", "stopped"), retry=False))
    assert bench.it.counters["attempts_failed"] == 1
    assert bench.it.take_condemned() == []
    assert bench.jobs_sent() == [("a", "j"), ("a", "j")]


def test_waiting_behind_another_job_is_no_overtime():
    bench = Bench()
    bench.ready("a", credits=2)
    bench.submit(job("j1", "set-1"), timeout_s=100.0)
    second = bench.submit(job("j2", "set-2"))
    bench.pass_time(50, "a")
    bench.complete("a", "j1")
    bench.pass_time(9, "a")
    bench.complete("a", "j2")
    assert second.end == ("done",)


def test_cancelled_before_it_began():
    bench = Bench()
    log = bench.submit(job("j"))
    assert bench.it.cancel("j", bench.now)
    bench.ready("a")
    assert bench.jobs_sent() == []
    assert log.events == [("failed", "Cancelled", False)]
    assert not bench.it.cancel("j", bench.now)


def test_cancelled_while_running_is_no_failure():
    bench = Bench("a")
    log = bench.submit(job("j"))
    bench.it.cancel("j", bench.now)
    bench.say("a", JobFailed("j", "decode", ErrorInfo("Cancelled", "stopped"), retry=False))
    assert log.end == ("failed", "Cancelled", False)
    assert bench.it.counters["attempts_failed"] == 0


def test_plugin_that_ignores_cancellation_costs_its_worker_but_is_no_failure():
    bench = Bench("a")
    log = bench.submit(job("j"))
    bench.it.cancel("j", bench.now)
    bench.pass_time(3, "a")
    assert [worker for worker, _ in bench.it.take_condemned()] == ["a"]
    assert log.end == ("failed", "Cancelled", False)
    assert bench.it.counters["attempts_failed"] == 0


def test_stage_delivered_before_the_crash_is_not_delivered_again():
    bench = Bench("a", "b")
    log = bench.submit(job("j", plugins=("decode", "triangulate")))
    [(first, _)] = bench.jobs_sent()
    bench.say(first, StageDone("j", "triangulate", 0.1, mesh("range")))
    bench.it.lost(first, "died", bench.now)
    [(second, _)] = bench.jobs_sent()
    bench.complete(second, "j", "triangulate", "decode")
    assert log.events == [("stage", "triangulate"), ("stage", "decode"), ("done",)]


def test_done_without_all_stages_is_a_failure():
    bench = Bench("a")
    log = bench.submit(job("j", plugins=("decode", "triangulate")))
    bench.complete("a", "j", "decode")
    assert log.end is None
    assert bench.it.counters["attempts_failed"] == 1


@pytest.mark.parametrize("product", [None, 3, {"a": 1}])
def test_answer_that_is_no_product_is_not_passed_on(product):
    bench = Bench("a")
    log = bench.submit(job("j"))
    bench.say("a", StageDone("j", "decode", 0.1, product))
    bench.say("a", JobDone("j"))
    assert log.events == []
    assert bench.it.counters["stray"] == 1


def test_late_answer_of_a_lost_worker_is_counted_and_ignored():
    bench = Bench("a", "b")
    log = bench.submit(job("j"))
    [(first, _)] = bench.jobs_sent()
    bench.it.lost(first, "seemed dead", bench.now)
    [(second, _)] = bench.jobs_sent()
    bench.complete(second, "j")
    bench.complete(first, "j")
    assert log.events == [("stage", "decode"), ("done",)]
    assert bench.it.counters["stray"] == 2


def test_unknown_worker_is_sent_home():
    bench = Bench()
    bench.say("ghost", WorkerAlive("ghost"))
    [(worker, message)] = bench.sent()
    assert worker == "ghost"
    assert isinstance(message, WorkerStop)


def test_sign_of_life_is_answered():
    bench = Bench("a")
    bench.say("a", WorkerAlive("a"))
    assert bench.sent() == [("a", WorkerAlive("a"))]


def test_message_that_does_not_belong_here_is_counted_and_answered():
    bench = Bench("a")
    bench.say("a", Request("1", "status"))
    bench.it.malformed("b", "no message at all")
    assert bench.it.counters["malformed"] == 2
    assert [(worker, message.code) for worker, message in bench.sent()] == [("a", "WireError"), ("b", "WireError")]


def test_error_is_not_answered_with_an_error():
    bench = Bench("a")
    bench.say("a", ErrorInfo("WireError", "you sent nonsense"))
    assert bench.sent() == []


def test_schemas_that_are_no_tables_are_ignored():
    bench = Bench()
    bench.ready("a", schemas={"processor": 3, "encoder": {"e": {}}})
    bench.submit(job("j"))
    assert bench.it.peers.schemas() == {"encoder": {"e": {}}}


def test_job_without_stages_or_with_a_taken_id_is_refused():
    bench = Bench("a")
    bench.submit(job("j"))
    for wrong in (job("j"), job("k", plugins=()), job("k", plugins=("decode", "decode"))):
        with pytest.raises(UsageError):
            bench.submit(wrong)


def test_shutdown_ends_every_job_and_sends_all_home():
    bench = Bench("a")
    logs = [bench.submit(job(name)) for name in ("j1", "j2")]
    bench.it.shutdown("the station stops")
    assert [log.end for log in logs] == [("failed", "Cancelled", False)] * 2
    assert bench.sent() == [("a", WorkerStop("the station stops"))]


def test_workers_may_answer_vanish_and_be_watched_after_shutdown():
    bench = Bench("a", "b")
    bench.submit(job("j"))
    (running,) = [name for name, _ in bench.jobs_sent()]
    bench.it.shutdown("the station stops")
    bench.sent()
    bench.say(running, JobDone("j"))
    bench.now = 1000.0
    bench.it.tick(bench.now)
    bench.it.lost("a", "exited with status 0", bench.now)
    bench.it.lost("b", "exited with status 0", bench.now)
    assert bench.it.counters["stray"] == 1
    assert bench.it.active == ()


def test_nothing_is_given_to_a_worker_after_shutdown():
    bench = Bench("a")
    bench.it.shutdown("the station stops")
    bench.sent()
    bench.submit(job("late"))
    assert bench.jobs_sent() == []


def test_subject_is_the_inputs_or_the_first_stage():
    encoder = StageCall("e", "encoder", "gray-code", {"bits": 5})
    same = StageCall("e", "encoder", "gray-code", {"bits": 5})
    other = StageCall("e", "encoder", "gray-code", {"bits": 6})
    names = [subject_of(Job("j", (stage,), {"projector": {"width_px": 5}})) for stage in (encoder, same, other)]
    assert names[0] == names[1] != names[2]
    assert names[0].startswith("encoder/gray-code#")
    assert subject_of(Job("j", (encoder,), {"views": [mesh("v1"), mesh("v2")], "again": mesh("v1")})) == "v1+v2"


def test_watcher_that_submits_from_its_callback_is_served():
    bench = Bench("a")
    followed = Log()

    def follow(_: JobDone) -> None:
        bench.it.submit(job("next"), followed.watcher(), bench.now)

    bench.it.submit(job("j"), Watcher(lambda _: None, follow, lambda *_: None), bench.now)
    bench.complete("a", "j")
    bench.complete("a", "next")
    assert followed.end == ("done",)
