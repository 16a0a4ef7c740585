"""The ceiling: how well simulated touches could be known at best, by sampling their posterior."""
