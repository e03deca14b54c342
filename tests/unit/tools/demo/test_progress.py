from support.builders_demo import make_results

from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.tools.demo.progress import Progress, status_line
from trigpoint.tools.demo.watch import Watch


def test_in_a_terminal_the_line_is_written_over_once_a_second():
    written: list[str] = []
    progress = Progress(written.append, is_terminal=True)
    for tenth in range(25):
        progress.show(tenth / 10, f"at {tenth}")
    assert [text.rpartition("K")[2] for text in written] == ["at 0", "at 10", "at 20"]
    assert not any("\n" in text for text in written)


def test_in_a_file_there_is_a_line_every_ten_seconds():
    written: list[str] = []
    progress = Progress(written.append, is_terminal=False)
    for second in range(25):
        progress.show(second, f"at {second}")
    assert "".join(written) == "at 0\nat 10\nat 20\n"


def test_what_is_said_gets_a_line_of_its_own():
    written: list[str] = []
    progress = Progress(written.append, is_terminal=True)
    progress.show(0.0, "going on")
    progress.say("fusion was ended")
    progress.close()
    assert "".join(written).endswith("\x1b[2Kfusion was ended\n")


def test_line_is_ended_once():
    written: list[str] = []
    progress = Progress(written.append, is_terminal=True)
    progress.show(0.0, "going on")
    progress.close()
    progress.close()
    assert "".join(written).count("\n") == 1


def test_status_tells_time_and_cameras():
    with MemoryBroker().session() as bus:
        watch = Watch(bus, "lab")
        watch.cameras["c1"], watch.robots["r1"] = 0.01, 0.023
        line = status_line(watch, 83.4, len(make_results().cameras))
        watch.close()
    assert "1:23" in line
    assert "1/2 cameras located" in line
    assert "±2.3 cm" in line
