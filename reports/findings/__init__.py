"""What runs show besides leaderboards, as a table and a figure each."""
