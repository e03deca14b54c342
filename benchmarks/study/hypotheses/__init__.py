"""Every place of a camera that its pictures allow where its robots' poses are known, each worked
out to its best: what studies hold against the truth."""
