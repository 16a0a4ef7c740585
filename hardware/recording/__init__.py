"""Recordings of boards: free or guided, exported, imported."""
