"""The live session: a process that solves, a filter that corrects, their messages."""
