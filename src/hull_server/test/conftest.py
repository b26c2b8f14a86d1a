import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # hull_scenes: the scenes and the oracle that these tests share
