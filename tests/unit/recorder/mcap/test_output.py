"""The lock by which others know that a file is being written."""

import os
from pathlib import Path

from trigpoint.recorder.mcap.output import Output, is_being_written


def test_a_closed_file_is_not_being_written_where_a_forked_child_still_has_it(
    tmp_path: Path,
) -> None:
    output = Output(tmp_path / "s.mcap")
    ends, begin = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(begin)
        os.read(ends, 1)
        os._exit(0)
    try:
        assert is_being_written(tmp_path / "s.mcap")
        output.close()
        output.close()  # as after an error
        assert not is_being_written(tmp_path / "s.mcap")
    finally:
        os.close(begin)
        os.waitpid(child, 0)
        os.close(ends)
