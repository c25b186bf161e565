"""The loop over trials, its storage, its workers, and what it leaves."""
