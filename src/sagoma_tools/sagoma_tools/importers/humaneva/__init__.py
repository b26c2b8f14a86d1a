"""HumanEva-I (Sigal, Balan & Black 2010) as session folders; one small parser for each of its file formats."""
