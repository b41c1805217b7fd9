#!/bin/sh
# build.sh FOLDER: generates the types and compiles FOLDER/witness; needs Debian's libfastrtps-dev,
# libfastcdr-dev, fastddsgen and g++.
set -e
here=$(dirname "$0")
mkdir -p "$1"
fastddsgen -typeros2 -cs -replace -d "$1" "$here/ros2.idl" >"$1/generated.txt" 2>&1
g++ -std=c++17 -O1 -I"$1" -o "$1/witness" "$here/witness.cpp" "$1/ros2.cxx" "$1/ros2PubSubTypes.cxx" \
  -lfastrtps -lfastcdr -lpthread
