"""What everything rests on: errors, clocks, words, logging, the terminal, an orderly end."""
