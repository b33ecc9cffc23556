# The golden vectors of the robot models come from Pinocchio and MuJoCo, through our URDF export: make them again.
venv=target/venv-robot-oracle
[ -x $venv/bin/python ] || python3 -m venv $venv
$venv/bin/pip install --quiet --disable-pip-version-check pin==4.1.0 mujoco==4.0.0
for robot in powercube6 kr16_2 pincher4; do
    cargo run --locked --quiet -p robot-model --example to_urdf -- $robot >target/$robot.urdf
done
$venv/bin/python host/robot-model/oracle/golden.py target host/robot-model/tests/data --check
