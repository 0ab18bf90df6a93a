"""Measurements that are no tests: ours and the peers side by side, five minutes with an arm, the page of findings."""
