# Sourced by the stages that run the command blocks of pages: these speak to a cell or a robot, which the stage readme provides. All
# others are run by the stage tutorials.
pages_with_a_cell=(README.md docs/real-arm.md docs/without-an-arm.md docs/industrial-robot.md host/python/README.md)
