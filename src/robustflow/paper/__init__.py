"""What only the paper needs: its tables and figures measured again, and the experiment on robust training."""
