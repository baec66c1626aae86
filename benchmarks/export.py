"""Write a run's agent as the one that ships for its environment: `python -m benchmarks.export RUN`.

The networks go into `sb3_stereo/pretrained/` in half precision, with the run's record and scores. The agent is then
evaluated on the test poses as it ships, and the scores go into `score.json` beside it.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from sb3_stereo import runtime
from sb3_stereo.building.factory import VEC_ENVS, make_env
from sb3_stereo.commands.evaluate import json_scores
from sb3_stereo.evaluation.callback import describe
from sb3_stereo.evaluation.protocol import eval_initial_states, evaluate
from sb3_stereo.pretrained import FOLDER
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.files import write
from sb3_stereo.runs.models import load_model
from sb3_stereo.runs.pretrained import export


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.export", description="Ship a run's agent.")
    parser.add_argument("run", type=Path, help="run directory")
    parser.add_argument("--load-best", action="store_true", help="its best model instead of the final one")
    parser.add_argument("-f", "--folder", type=Path, default=FOLDER, help="log folder to write into")
    args = parser.parse_args(argv)
    run = export(args.run, args.folder, args.load_best)
    config = load_record(run)[0].evaluated
    path = model_path(run, config.env_id)
    n_envs = runtime.free_cores()
    env_fn = make_env(config.env_id, config.env_kwargs, config.env_wrapper)
    states = eval_initial_states(config.env_id, config.env_kwargs)
    model = load_model(config, path)
    result = evaluate(model, env_fn, states, n_envs, VEC_ENVS["subproc" if n_envs > 1 else "dummy"])
    write(run / "score.json", (json.dumps(json_scores(result.scores()), indent=1) + "\n").encode())
    print(f"{path}, {path.stat().st_size / 1e6:.2f} MB: {describe(result)}")


if __name__ == "__main__":
    main()
