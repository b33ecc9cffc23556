# The golden vectors of the robot models come from Pinocchio and MuJoCo, through our URDF export: make them again.
venv=target/oracle
if [ ! -x "$venv/bin/python" ]; then
    python3 -m venv "$venv"
fi
"$venv/bin/pip" install --quiet pin==4.1.0 mujoco==4.0.0
for robot in powercube6 kr16_2 pincher4; do
    cargo run --quiet -p robot-model --example to_urdf -- "$robot" >"target/$robot.urdf"
done
"$venv/bin/python" host/robot-model/oracle/golden.py target host/robot-model/tests/data --check
