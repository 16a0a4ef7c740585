"""Classical reconstruction: linear one-step methods, total variation, Gauss-Newton."""
