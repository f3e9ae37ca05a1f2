"""A result in words: its figures as plain numbers, a line per stage, the verdict, and advice."""
