"""What the cards (one file per figure or table) share: the job, studies, claims and drawing by topic."""
