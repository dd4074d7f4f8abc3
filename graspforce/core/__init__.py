"""What every other package uses: errors, array checks, records, JSON."""
