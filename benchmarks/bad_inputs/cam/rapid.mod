%%%
VERSION:1
LANGUAGE:ENGLISH
%%%
MODULE part
PERS wobjdata w:=[FALSE,TRUE,"",[[100,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
CONST robtarget p:=[[0,0,50],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget via:=[[15,5,0],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST speeddata v:=[25,500,5000,1000];
PROC main()
ConfL\Off;
MoveAbsJ [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,t;
MoveJ p,v100,z10,t\WObj:=w;
MoveL Offs(p,10,0,
-50),v,fine,t\WObj:=w; ! in
MoveC via,[[20,0,0],[0,0.1,0.995,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v20,z1,t\WObj:=w;
MoveL p,v50,z0,t\WObj:=w;
TPWrite "done; !";
SetDO doMill,1;
WaitTime 2;
VelSet 50,1000;
MoveLDO RelTool(p,1,2,3),v50,z0,t\WObj:=w,do1,1;
cut;
ENDPROC
PROC cut()
MoveL Offs(p,5,5,5),v50\V:=10,z0,t\WObj:=w;
ENDPROC
ENDMODULE
