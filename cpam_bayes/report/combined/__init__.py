"""What `report` shows: the answers of its parts on one page."""
