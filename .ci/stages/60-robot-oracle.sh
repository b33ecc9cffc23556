# The golden vectors of the robot models come from Pinocchio and MuJoCo, through our URDF export: make them again.
. .ci/venv.sh robot-oracle robots/model/oracle/requirements.txt
. .ci/debug-build.sh
for robot in powercube6 kr16_2 pincher4; do
    target/debug/examples/to_urdf $robot >target/$robot.urdf
done
python robots/model/oracle/golden.py target robots/model/tests/data --check
python host/planner/oracle/disc.py target/pincher4.urdf host/planner/tests/data/disc_kinematics.json --check
