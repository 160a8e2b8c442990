"""Generated plants of small order through every analysis and design, against exact answers."""
