"""From the last frame of a 12-frame set to its range image published: 1392 x 1040, warm."""

from __future__ import annotations

import statistics

from stationkit import figure, info, station

from fringed_client import Station

SCANS = 12
WARM_UP = 3
FEEDS = ("sets_fed", "sets_unfed", "feeds_dropped", "feeds_refused")


def main() -> None:
    with station(), Station() as client:
        timings = []
        before = client.status().counters
        for index in range(SCANS + WARM_UP):
            result = client.scan(pipeline="hierarchical")
            if index >= WARM_UP:
                timings.append(dict(result.state.timings_s))
        after = client.status().counters
    fed = {name: after.get(f"work_{name}", 0) - before.get(f"work_{name}", 0) for name in FEEDS}
    latency_ms = sorted(1e3 * t["last_frame_to_range_image"] for t in timings)
    median = statistics.median(latency_ms)
    spread = f"median {median:.0f} ms, {latency_ms[0]:.0f} to {latency_ms[-1]:.0f} ms over {SCANS} scans"
    figure("last frame to range image published", spread, "at most 100 ms", median <= 100)
    for key in sorted({key for t in timings for key in t}):
        values = [1e3 * t[key] for t in timings if key in t]
        info(f"  {key}", f"median {statistics.median(values):.1f} ms, best {min(values):.1f} ms")
    info("sets that reached a worker while they were taken", f"{fed['sets_fed']} of {SCANS + WARM_UP} ({fed})")


if __name__ == "__main__":
    main()
