"""Figures drawn with Matplotlib, which is loaded when one is drawn."""
