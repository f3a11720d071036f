"""What only the paper needs: its tables and figures measured again, and its observations."""
