"""What the instrument is worth in the simulated world ``outside``: scenes, rigs and judgements, part by part."""
