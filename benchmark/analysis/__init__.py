"""What stored runs show: results, standings, comparisons, submissions."""
