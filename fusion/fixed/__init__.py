"""A map that stays as it is: robots are placed in it, and nothing is learnt."""
