"""The compiled core under inputs that nobody would give it, with the sanitizers looking on."""
